"""Two recorded runs of one truth on one page: the other as ghosts, lines, differences, ratios."""
