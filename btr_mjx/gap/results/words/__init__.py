"""Sentences of a diagnosis: functions of the entries of result.json that return text and compute nothing else.

`effects` has words for effects and places, `terms` for numbers, `verdict` has the verdict, `details` the rest, and
`changes` what has changed from one set of recordings to the next.
"""
