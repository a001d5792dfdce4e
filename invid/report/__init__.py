"""The report: one HTML file, its pictures as SVG strings and their data as plain lists.

A module each: the drawing of the branches does without the plot library.
"""
