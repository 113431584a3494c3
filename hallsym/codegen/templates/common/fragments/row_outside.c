for (uint32_t k = 0U; k < {{ count }}U; k++)
{
    found |= ((p->{{ name }}[k] >= {{ low }}) && (p->{{ name }}[k] <= {{ high }})) ? 0U : DECOUPLER_BAD_NUMBER;
}
