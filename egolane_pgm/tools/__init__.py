"""Tools that know nothing of lanes: files, YAML, processes, bars, compiled loops."""
