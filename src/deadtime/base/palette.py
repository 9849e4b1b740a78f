"""The colours of figures and pages; those of Okabe and Ito come first.

Colour-blind readers tell them apart too, and all can be read on a light and on a dark ground.
"""

BLUE, VERMILION, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
ORANGE, SKY, BLACK = "#E69F00", "#56B4E9", "#000000"
PURPLE, BROWN, OLIVE, SLATE, GREY = "#7a4fa3", "#8b5a2b", "#7f9f2f", "#4a6b8a", "#8a8a8a"
