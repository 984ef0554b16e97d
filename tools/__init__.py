"""Command line, figures and experiments."""
