"""A verb in a module that needs what is not installed."""

raise ModuleNotFoundError("No module named 'cv2'", name="cv2")
