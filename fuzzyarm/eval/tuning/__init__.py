"""The search for the parameters of model-based policies, by the rules used for the shipped ones."""
