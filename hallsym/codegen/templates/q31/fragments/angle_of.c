/* Angle of a vector in 2^-32 turns by CORDIC: step k turns it by atan 2^-k towards the x axis. */
static uint32_t angle_of(int32_t x, int32_t y)
{
    static const uint32_t arctangents[{{ steps }}] = {
        {{ arctangents }}};
    int32_t across = x;
    int32_t up = y;
    uint32_t angle = 0U;
    if (x < 0)
    {
        across = difference(0, x);
        up = difference(0, y);
        angle = 0x80000000U;
    }
    //@ loop unroll {{ steps }};
    for (uint32_t k = 0U; k < {{ steps }}U; k++)
    {
        const int32_t a = across >> k;
        const int32_t b = up >> k;
        if (up < 0)
        {
            across = difference(across, b);
            up = sum(up, a);
            angle -= arctangents[k];
        }
        else
        {
            across = sum(across, b);
            up = difference(up, a);
            angle += arctangents[k];
        }
    }
    return angle;
}

