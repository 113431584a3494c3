"""The content of each figure, as `Picture`s of typed results, for files, pages and sessions.

Data stay in SI; axes say um, urad or mV. Colours differ in lightness and every series has its own dash or
marker, so that a greyscale print can be read. Those of a fit follow Figures 9 to 12 of Chen et al., Sensors
2016, 16, 872, doi:10.3390/s16060872. A log of any length is read in blocks and reduced to its least and
greatest value per column (`hallsym.report.data`), so a peak never gets lost.
"""
