"""Pictures of simulated motorways."""
