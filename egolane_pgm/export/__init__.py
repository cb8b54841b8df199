"""A result as an MCAP file for Foxglove and PlotJuggler, from what `drive` gathers."""
