"""The parts of the multi-lane detector MLD (Hur, Kang and Seo, IEEE Intelligent Vehicles 2013), in
the order in which a picture passes through them: `markings` (row by row, joined to seeds), `crf`
(which seeds belong to one line), `curves` (robust fits) and `slots` (the tracker)."""
