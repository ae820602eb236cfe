"""The lanes engine: one array per physical scalar, the batch along its last axis."""
