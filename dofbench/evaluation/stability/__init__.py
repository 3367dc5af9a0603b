"""Stiff and extreme cases for kernels, image code and methods; each states a property and an error bound."""
