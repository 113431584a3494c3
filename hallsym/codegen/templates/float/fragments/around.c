
static @REAL@ around(@REAL@ value, @REAL@ period)
{
    const @REAL@ half = period * @HALF@;
    return (value > half) ? (value - period) : ((value < -half) ? (value + period) : value);
}
