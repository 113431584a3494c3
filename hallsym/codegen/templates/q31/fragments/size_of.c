static int64_t size_of(int32_t left, int32_t root)
{
    const int64_t size = (int64_t)left * root;
    return (size < 0) ? -size : size;
}

