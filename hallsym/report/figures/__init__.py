"""Pictures for print: of a fit, of what data determine, of budgets, tolerances and plans.

Those of a fit follow Figures 9 to 12 of Chen et al., Sensors 2016, 16, 872, doi:10.3390/s16060872. What is
drawn comes from `hallsym.report.data`: a log of any length is read in blocks and reduced to its least and
greatest value per picture column, so a peak never gets lost. Data stay in SI; axes say um, urad or mV.
Colours differ in lightness and every series has its own line style or marker, so that a greyscale print can
be read. matplotlib is imported only to draw.
"""
