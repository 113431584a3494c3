/* {{ why_ends }} */
static const ends_t ends[{{ ranges }}] = {
    {{ ends }}
};
