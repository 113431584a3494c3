/** Parameter table: constant, in flash; a copy in RAM where decoupler_zero() is used. */
typedef struct
{
    uint32_t crc; /**< CRC-32 of what follows, up to the CRC of the zeros */
    uint32_t version; /**< DECOUPLER_VERSION */
    uint32_t layout; /**< DECOUPLER_LAYOUT */
    uint32_t length; /**< [byte] of the table */
    uint32_t calibration[2]; /**< first 8 bytes of the SHA-256 of the calibration */
{% for e in b.constant %}
    {{ e.member }}
{% endfor %}
    uint32_t zeros_crc; /**< CRC-32 of the zeros */
{% for e in b.offsets %}
    {{ e.member }}
{% endfor %}
} decoupler_params_t;
