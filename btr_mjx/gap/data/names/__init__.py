"""What the columns of a log are called, which of the model's they are, and in which unit."""
