"""Sentences of a diagnosis: functions of the entries of result.json that return text and compute nothing else.

`terms` has words for effects, places and numbers, `verdict` the verdict and its details, `changes` what has changed
from one set of recordings to the next.
"""
