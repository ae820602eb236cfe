"""Forms that recordings come in, one file a form."""
