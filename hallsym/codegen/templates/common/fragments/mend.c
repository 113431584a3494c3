if (p->root[k] > @ZERO@)
{
    @REAL@ rest[@WATCHED@];
    const uint32_t again = without(p, in, k, numbers[k], rest, out);
    const uint32_t degraded = ((again & DECOUPLER_STATUS_FAULT) == 0U) ? DECOUPLER_STATUS_DEGRADED : 0U;
    result = (status & @INPUT_BITS@) | (again & @FLAG_BITS@) | degraded;
}
