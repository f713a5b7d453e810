"""Camera selection: expected information, occlusion, policies, failure detector."""
