"""The sample models of `robots/`, one module a family, built from published dimensions."""
