"""Figures and the page that shows them; matplotlib is imported only to draw."""
