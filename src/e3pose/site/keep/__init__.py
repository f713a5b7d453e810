"""What is kept of a site, for the page: files made of its store, and its recordings.

a wish (form, time, people) -> jobs (a queue, a folder, one child at a time) -> making (the child)
"""
