"""Frozen answers to hidden cases, and how two versions of them are compared; the command is `benchmarks/gate.py`.

`suites` has the kinds of cases, `cases` makes and solves them, `answers` has digests of code and data, `names` and
`forces` judge answers, `rows` and `pairing` count.
"""
