for (uint32_t k = 0U; k < @COUNT@U; k++)
{
    found |= ((p->@NAME@[k] >= @LOW@) && (p->@NAME@[k] <= @HIGH@)) ? 0U : DECOUPLER_BAD_NUMBER;
}
