static unsigned long wrong_@B@(int32_t @B@)
{
    @LINES@
    const double share = ((double)@B@ * @B_UNIT@) * ((double)@R@ * @R_UNIT@);
    const double off = ((share > 1.0) ? (share - 1.0) : (1.0 - share)) / ((double)@B@ * @B_UNIT@);
    const double size = (off < 0.0) ? -off : off;
    return ((size <= @ERROR@) && (@R@ >= @LEAST@) && (@R@ <= @MOST@)) ? 0UL : 1UL;
}

