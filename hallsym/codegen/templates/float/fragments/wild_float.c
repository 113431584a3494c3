(void)memcpy(&value, &raw, sizeof(value));
