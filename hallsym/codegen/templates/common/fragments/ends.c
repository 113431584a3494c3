/* @WHY_ENDS@ */
static const ends_t ends[@RANGES@] = {
    @ENDS@
};
