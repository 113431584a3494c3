    if (p->root[k] > {{ zero }})
    {
        {{ real }} rest[{{ d.watched | length }}];
        const uint32_t again = without(p, in, k, numbers[k], rest, out);
        const uint32_t degraded = ((again & DECOUPLER_STATUS_FAULT) == 0U) ? DECOUPLER_STATUS_DEGRADED : 0U;
        result = (status & {{ suspects.input_bits | mask }}) | (again & {{ suspects.flag_bits | mask }}) | degraded;
    }
