"""The morph-space PCA model of one person (Nagle section 2): morphs, the build, encoding, the model file."""
