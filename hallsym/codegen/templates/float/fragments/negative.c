static uint32_t negative(@REAL@ value) /* -0 is: its bits are no limit */
{
    union
    {
        @REAL@ value;
        @WORD@ bits;
    } number;
    number.value = value;
    return ((number.bits & @SIGN_MASK@) != 0U) ? 1U : 0U;
}

