uint64_t bits = 0U;
(void)memcpy(&bits, &value, sizeof(bits));
return (uint32_t)(bits >> 32U) ^ mix((uint32_t)bits);
