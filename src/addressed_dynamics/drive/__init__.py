"""A page on 127.0.0.1 in which a person drives a model, beside the truth where there is an environment."""
