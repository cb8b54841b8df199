"""Maps: the lanes of the road from OpenStreetMap (© OpenStreetMap contributors, ODbL), and the car
on it. The libraries of the extra `maps` are imported where they are used.
"""
