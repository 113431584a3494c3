/* Correction at a phase, both in 2^-32 turns: a line between two of its @COUNT@ entries (@KIND@). */
static int32_t @NAME@_at(const decoupler_params_t *p, uint32_t phase)
{
    const uint32_t cell = phase >> @FIRST@U;
    const uint32_t way = (phase >> @FINER@U) & @WAY@U;
    const int32_t rest = (int32_t)way;
    const int32_t left = @LEFT@;
    const int32_t rise = difference(@RIGHT@, left);
    @BETWEEN@
}

