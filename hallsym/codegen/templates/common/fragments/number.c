
#define NUMBERS ((uint32_t)offsetof(decoupler_params_t, {{ first }}))
#define ZEROS_LESS (ZEROS - {{ limits_to }}U) /* so that the zeros are counted on from the limits */

typedef struct
{
    {{ number }} least;
    {{ number }} greatest;
} ends_t;

static {{ number }} number(const uint8_t *bytes)
{
    union
    {
        {{ number }} value;
        uint8_t bytes[{{ size }}];
    } found;
    for (uint32_t k = 0U; k < {{ size }}U; k++)
    {
        found.bytes[k] = bytes[k];
    }
    return found.value;
}

