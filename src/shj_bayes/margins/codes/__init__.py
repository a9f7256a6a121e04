"""Design codes; `code.catalogue` finds them in the modules here."""
