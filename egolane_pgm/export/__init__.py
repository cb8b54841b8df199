"""A result as a file of the viewers in which people look at drives of robots: `out.mcap` for
Foxglove and PlotJuggler, `out.rrd` for rerun. One file per format of what `drive` gathers."""
