static {{ real }} size_of({{ real }} left, {{ real }} root)
{
    return MAGNITUDE(left * root);
}

