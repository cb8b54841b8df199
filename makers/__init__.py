"""Programs that write pages of `results/` and tables of `docs/`; the Makefile runs them."""
