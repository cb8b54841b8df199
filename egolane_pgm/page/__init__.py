"""The page of results: one HTML file with a timeline, jump lists and scores."""
