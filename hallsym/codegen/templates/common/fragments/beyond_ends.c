for (uint32_t k = 0U; k < {{ ranges }}U; k++)
{
    const {{ number }} value = number(&bytes[(k * {{ size }}U) + {{ place }}]);
    if (!((value >= ends[k].least) && (value <= ends[k].greatest)))
    {
        found |= {{ kind }};
    }
}
