    /* each reading that it may be in turn: the one without which the others contradict one another least */
    if (p->root[k] > {{ zero }})
    {
        {{ real }} rest[{{ d.watched | length }}];
        decoupler_out_t tried;
        {{ real }} least = {{ zero }};
        for (uint32_t n = first[k]; n < first[k + 1U]; n++)
        {
            const uint32_t again = without(p, in, k, numbers[n], rest, &tried);
            {{ real }} sum = {{ zero }};
            for (uint32_t m = 0U; m < {{ d.watched | length }}U; m++)
            {
                sum += rest[m] * rest[m];
            }
            if ((n == (uint32_t)first[k]) || (sum < least))
            {
                const uint32_t degraded = ((again & DECOUPLER_STATUS_FAULT) == 0U) ? DECOUPLER_STATUS_DEGRADED : 0U;
                result = (status & {{ suspects.input_bits | mask }}) | (again & {{ suspects.flag_bits | mask }}) | degraded;
                least = sum;
{% for o in outputs %}
                out->{{ o.member }} = tried.{{ o.member }};
{% endfor %}
                out->suspect = numbers[n];
            }
        }
    }
