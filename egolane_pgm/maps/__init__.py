"""Where the number of lanes comes from: the lanes of the road, where they lead, and the car.

The lanes are those of OpenStreetMap (© OpenStreetMap contributors, ODbL). They are read by
libraries of the package's extra `maps`, which are imported where they are used.
"""
