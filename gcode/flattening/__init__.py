"""Flattening of part programs: parameters, expressions, O-words, subprograms and canned cycles become plain blocks.

The language is that of LinuxCNC 2.9 (RS-274/NGC, NISTIR 6556, with named parameters and O-words), and M98 and M99 as on
Fanuc-like controllers. A plain program passes unchanged, line by line.
"""
