"""Files made of a site's store, and its recordings, for the page.

request (form, time, people) -> jobs (a queue, a folder, one child at a time) -> making (child)
"""
