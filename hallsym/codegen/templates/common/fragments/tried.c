        const uint32_t inside = ((value >= low) && (value <= high)) ? 1U : 0U;
        const uint32_t good = ((held >= low) && (held <= high)) ? 1U : 0U;
        const uint32_t same = ((inside == 0U) || (held == value)) ? 1U : 0U;
        bad += ((good & same & (status ^ inside)) == 1U) ? 0UL : 1UL;
        bits++;
    } while (bits != 0U);
    return bad;
}
