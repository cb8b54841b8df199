"""Maps: the lanes of the road, where they lead, and where the car is on them.

The lanes are those of OpenStreetMap (© OpenStreetMap contributors, ODbL). They are read by
libraries of the package's extra `maps`, which are imported where they are used.
"""
