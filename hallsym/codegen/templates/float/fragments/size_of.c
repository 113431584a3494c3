static float size_of(float left, float root)
{
    return MAGNITUDE(left * root);
}

