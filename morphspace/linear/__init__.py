"""Linear algebra without faces: rows, principal components, convex mixtures, errors."""
