"""Vectors and inner products, no faces: rows, principal components, convex mixtures, measures of error."""
