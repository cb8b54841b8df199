"""The page of one or several results: one HTML file that loads nothing, with an interactive
timeline.

`document` writes it, `timeline` has the panels, `packed` what they show in few bytes, `lists` what
a click goes to. In the browser `page.js` draws each panel as one picture, at the resolution of the
screen: a column of pixels is a frame, or the mean over the frames that lie in it.
"""

from __future__ import annotations
