//! Every real scene is imported and drawn, whole.

use ropewalk::{DeviceChoice, Error, Renderer, RendererOptions, Scene, View, gltf};
use ropewalk_testkit::corpus::{gltf_files, scenes};

#[test]
fn every_scene_is_drawn_whole() {
    let Some(folder) = scenes("every_scene_is_drawn_whole") else { return };
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
    let (mut drawn, mut refused) = (0, 0);
    for file in ["gltf", "meshes", "scenes"].iter().flat_map(|kind| gltf_files(&folder.join(kind))) {
        let name = file.display();
        let mut scene = Scene::new();
        let root = scene.root();
        let import = match gltf::import(&file, &mut scene, root) {
            Ok(import) => import,
            Err(Error::UnsupportedExtension { .. }) => {
                refused += 1;
                continue;
            }
            Err(error) => panic!("{error}"),
        };
        let view = View { aovs: true, ..View::framing(&mut scene, 64, 48).unwrap() };
        let frame = renderer.render(&mut scene, &view).unwrap();
        let compile = &frame.report().compile;
        assert_eq!(compile.instanced_triangles as u64, import.counts.scene_triangles, "{name}");
        assert_eq!(compile.unhittable_instances, 0, "{name}");

        let image = frame.image().unwrap();
        assert!(image.color.iter().flatten().all(|c| c.is_finite()), "{name}: a pixel is not finite");
        let seen = image.aovs.unwrap().triangle.iter().filter(|&&triangle| triangle != u32::MAX).count();
        assert!(import.counts.scene_triangles == 0 || seen > 0, "{name}: nothing is seen");
        drawn += 1;
    }
    assert!(drawn > 100 && refused >= 2, "{drawn} scenes drawn, {refused} refused");
}
