"""Columns: which column of a log is which coordinate or command of a model, and in which unit.

`model_columns` names the columns of a model, `matching` finds them in a log by the words of their names (`words`,
`one_column`) and `units`, `required` asks for what is missing, in the words of `remedy`, and `plan` puts this together.
"""
