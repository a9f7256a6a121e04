"""Numbers to pages: figures that only draw, words, templates."""
