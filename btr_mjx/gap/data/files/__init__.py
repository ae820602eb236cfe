"""Formats of files: each becomes tables of named columns (`table.LogTable`), whatever robot they are of.

`readers.read_file` chooses the `Reader` of a file by its suffix, of a folder by its content; installed packages add
readers in the entry point group `btr_mjx.readers`. Names and units stay as they are in the file: what they mean for a
model is decided in `columns`.
"""
