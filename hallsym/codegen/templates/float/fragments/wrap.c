const @REAL@ turns_@INDEX@ = zeros[@INDEX@] / @PERIOD@; /* at most two: a zero, and what the pose moves by */
zeros[@INDEX@] -= @PERIOD@ * (@REAL@)(int32_t)turns_@INDEX@;
