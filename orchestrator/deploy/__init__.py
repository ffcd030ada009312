"""A network on other machines: bundles, containers, Compose, Kubernetes."""
