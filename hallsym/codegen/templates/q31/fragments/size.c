static uint64_t size(int32_t value)
{
    const int64_t wide = (int64_t)value;
    const int64_t positive = (wide < 0) ? -wide : wide;
    return (uint64_t)positive;
}

