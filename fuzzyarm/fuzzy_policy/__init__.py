"""The Takagi-Sugeno model, controller files, and control laws as policies."""
