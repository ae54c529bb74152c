"""Colours, markers and sizes that all figures share.

Colours are those of Okabe and Ito, which the colour-blind tell apart, and always come with a marker
or a label.
"""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
STYLES = ("-", "--", "-.", ":")
BLACK, GREY = "#000000", "#777777"
SMALL = 8
