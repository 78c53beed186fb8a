// consumer MESH AUDIO OUT.npz: animates a face with the installed weights and says what came out.
#include <exception>
#include <iostream>

#include "freetalk/audio/audio.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/mesh/normals.h"
#include "freetalk/talker/talker.h"

namespace {

int run(const std::string& mesh_path, const std::string& audio_path, const std::string& out_path) {
  const auto mesh = freetalk::mesh::load_mesh(mesh_path);
  const auto normals = freetalk::mesh::vertex_normals(mesh.vertices, mesh.faces);
  std::cout << "vertices " << mesh.num_vertices() << "\n"
            << "normals_unit " << (normals.rowwise().norm().array() - 1.0).abs().maxCoeff() << "\n";

  auto talker = freetalk::talker::Talker::from_pretrained(FREETALK_PRETRAINED_DIR "/open-small");
  freetalk::talker::TalkerOptions options;
  options.emotion = "happy";
  options.intensity = 2.0;
  options.num_steps = 4;
  options.seed = 1;
  const auto animation = talker.animate(freetalk::audio::load_audio(audio_path), mesh, options);
  animation.save(out_path);
  std::cout << "frames " << animation.num_frames() << "\n"
            << "largest_motion " << animation.displacements.abs().max().item<float>() << "\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) {
    std::cerr << "usage: consumer MESH AUDIO OUT.npz\n";
    return 2;
  }
  try {
    return run(argv[1], argv[2], argv[3]);
  } catch (const std::exception& error) {
    std::cerr << "consumer: " << error.what() << "\n";
    return 1;
  }
}
