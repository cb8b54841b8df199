"""A benchmark of ego-lane estimation from line lists: tracks of drives, entries that answer for
each frame, their scores, and the board that sets them side by side.

An entry sees the lines of a drive and the number of lanes, nothing else. Whole drivers, trips and
donors of lines are held out, never frames.
"""
