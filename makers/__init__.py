"""Programs that make pages in `results/` and tables in `docs/`; `make` names how each is run."""
