"""Catalogue of conventions that logs use instead of MuJoCo's, and the lines of dataset.toml that declare them.

`alternative` says what one is, `units` and `joint_orders` list units and orders of columns, `catalogue` everything for
a dataset, and `declared` writes the lines.
"""
