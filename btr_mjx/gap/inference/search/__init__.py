"""Search for candidates: linear scan, refinement of the leaders by simulation, comparison of rivals."""
