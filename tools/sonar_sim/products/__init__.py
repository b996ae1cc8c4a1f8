"""What one ping gives besides its samples: camera pictures, fans, point clouds, ground truth."""

from sonar_sim.products.sounding import PingProducts, ProductRenderer
from sonar_sim.products.writer import PRODUCTS, write_products

__all__ = ["PRODUCTS", "PingProducts", "ProductRenderer", "write_products"]
