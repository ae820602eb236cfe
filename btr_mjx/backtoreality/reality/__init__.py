"""Where measured fitness comes from."""
