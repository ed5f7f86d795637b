"""The scenario of an episode: references, disturbances, cases and domain randomisation."""
