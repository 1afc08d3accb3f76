"""Recipes, a stimulus set as a text: what one may say, its placeholders, and its text with line numbers (ours)."""
