for (uint32_t k = 0U; k < @RANGES@U; k++)
{
    const @NUMBER@ value = number(&bytes[(k * @SIZE@U) + @PLACE@]);
    if (!((value >= ends[k].least) && (value <= ends[k].greatest)))
    {
        found |= @KIND@;
    }
}
