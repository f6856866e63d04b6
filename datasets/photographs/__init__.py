"""What readers of image files with cameras share: files in any order -> Scene (scene.to_scene)."""
