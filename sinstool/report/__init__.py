"""Figures and the page that shows them; plotly and matplotlib are imported when they draw."""
