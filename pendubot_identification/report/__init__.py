"""A result in; page, figures and tables out. It decides nothing."""
