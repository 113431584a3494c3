/* each reading that it may be in turn: the one without which the others contradict one another least */
if (p->root[k] > @ZERO@)
{
    @REAL@ rest[@WATCHED@];
    decoupler_out_t tried;
    @REAL@ least = @ZERO@;
    for (uint32_t n = first[k]; n < first[k + 1U]; n++)
    {
        const uint32_t again = without(p, in, k, numbers[n], rest, &tried);
        @REAL@ sum = @ZERO@;
        for (uint32_t m = 0U; m < @WATCHED@U; m++)
        {
            sum += rest[m] * rest[m];
        }
        if ((n == (uint32_t)first[k]) || (sum < least))
        {
            const uint32_t degraded = ((again & DECOUPLER_STATUS_FAULT) == 0U) ? DECOUPLER_STATUS_DEGRADED : 0U;
            result = (status & @INPUT_BITS@) | (again & @FLAG_BITS@) | degraded;
            least = sum;
            out->@out.member@ = tried.@out.member@;
            out->suspect = numbers[n];
        }
    }
}
