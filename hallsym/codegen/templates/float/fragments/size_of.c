static @REAL@ size_of(@REAL@ left, @REAL@ root)
{
    return MAGNITUDE(left * root);
}

