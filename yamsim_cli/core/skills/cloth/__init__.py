"""Skills of cloth: which hands reach its points, how they carry these, and what folds, flattens or slides it."""
