"""What a finished search says: the records of a diagnosis, made of fits and simulations, without any decision left."""
