const {{ real }} turns_{{ index }} = zeros[{{ index }}] / {{ period }}; /* at most two: a zero, and what the pose moves by */
zeros[{{ index }}] -= {{ period }} * ({{ real }})(int32_t)turns_{{ index }};
