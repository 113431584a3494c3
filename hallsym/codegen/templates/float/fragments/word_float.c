uint32_t bits = 0U;
(void)memcpy(&bits, &value, sizeof(bits));
return bits;
