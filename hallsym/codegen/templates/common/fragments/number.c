
#define NUMBERS ((uint32_t)offsetof(decoupler_params_t, @FIRST@))
#define ZEROS_LESS (ZEROS - @LIMITS_TO@U) /* so that the zeros are counted on from the limits */

typedef struct
{
    @NUMBER@ least;
    @NUMBER@ greatest;
} ends_t;

static @NUMBER@ number(const uint8_t *bytes)
{
    union
    {
        @NUMBER@ value;
        uint8_t bytes[@SIZE@];
    } found;
    for (uint32_t k = 0U; k < @SIZE@U; k++)
    {
        found.bytes[k] = bytes[k];
    }
    return found.value;
}

