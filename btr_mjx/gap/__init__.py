"""Diagnosis of the gap between a model and recordings of a robot: which physical effect the model lacks.

One folder a stage: `data` (recordings), `preflight` (checks), `effects` (library), `simulate` (batches of worlds),
`windows` (multiple shooting), `inference` (search and decision), `results`, `report`, `fitness_only`, `experiments`.
"""
