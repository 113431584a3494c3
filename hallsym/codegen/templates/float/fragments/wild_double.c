const uint64_t bits = ((uint64_t)raw << 32U) | (uint64_t)mix(raw);
(void)memcpy(&value, &bits, sizeof(value));
