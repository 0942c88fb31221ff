from tests.core.scene.assets.conftest import contents, local_pip, world

__all__ = ["contents", "local_pip", "world"]
