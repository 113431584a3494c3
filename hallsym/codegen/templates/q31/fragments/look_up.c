/* Correction at a phase, both in 2^-32 turns: a line between two of its {{ count }} entries ({{ kind }}). */
static int32_t {{ name }}_at(const decoupler_params_t *p, uint32_t phase)
{
    const uint32_t cell = phase >> {{ first }}U;
    const uint32_t way = (phase >> {{ finer }}U) & {{ way }}U;
    const int32_t rest = (int32_t)way;
    const int32_t left = {{ left }};
    const int32_t rise = difference({{ right }}, left);
    {{ between }}
}

