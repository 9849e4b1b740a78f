"""The paper's sufficient condition, corrected and sharpened."""
