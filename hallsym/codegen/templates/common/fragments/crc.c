#define LENGTH ((uint32_t)sizeof(decoupler_params_t))
#define COVERED ((uint32_t)offsetof(decoupler_params_t, version))
#define ZEROS_CRC ((uint32_t)offsetof(decoupler_params_t, zeros_crc))
#define ZEROS ((uint32_t)offsetof(decoupler_params_t, {{ b.offsets[0].name }}))

uint32_t decoupler_crc(const uint8_t *bytes, uint32_t count) /* IEEE 802.3, bit by bit */
{
    uint32_t crc = 0xFFFFFFFFUL;
    for (uint32_t k = 0U; k < count; k++)
    {
        crc ^= (uint32_t)bytes[k];
        for (uint32_t n = 0U; n < 8U; n++)
        {
            crc = ((crc & 1U) != 0U) ? ((crc >> 1U) ^ 0xEDB88320UL) : (crc >> 1U);
        }
    }
    return ~crc;
}
