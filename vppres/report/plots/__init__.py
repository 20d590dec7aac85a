"""Figures of one run, or of several runs of the same day side by side, as SVG.

Quantities that hold over a step are drawn as steps, states at an instant as points joined by
lines. Runs differ in colour, dashes and width, so that the figures survive a grey print and
colour-blind eyes.
"""
