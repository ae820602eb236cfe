"""Foreign file formats of recordings, one module per format."""
