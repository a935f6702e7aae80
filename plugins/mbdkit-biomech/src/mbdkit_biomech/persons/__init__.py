"""A person from markers: plane of motion, joint centres with covariances, scaled model, and plates under feet."""
