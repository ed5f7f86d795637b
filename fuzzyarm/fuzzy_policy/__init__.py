"""The Takagi-Sugeno model, controller files, their certificates, and the fixed policies."""
