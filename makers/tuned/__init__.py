"""What a search of the paper's parameters gives for each run, detector and road."""
