static int32_t in_32_bits(int64_t value)
{
    const int64_t most = 0x7FFFFFFF;
    const int64_t least = -most;
    return (int32_t)((value > most) ? most : ((value < least) ? least : value));
}

