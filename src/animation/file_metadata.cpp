#include "file_metadata.h"

namespace freetalk::animation {

nlohmann::ordered_json metadata_in_metres(const Animation& animation) {
  auto metadata = nlohmann::ordered_json::parse(animation.metadata_json);
  try {
    auto& alignment = metadata.at("alignment");
    auto& pose = alignment.at("to_canonical");
    auto& rows = pose.at("rotation");
    Eigen::Matrix3d turn;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) turn(r, c) = rows.at(r).at(c).get<double>();
    }
    const double scale = pose.at("scale").get<double>() / animation.frame.metres_per_unit;
    turn = (turn * animation.frame.to_y_up.transpose()).eval();
    for (int r = 0; r < 3; ++r) rows[r] = {turn(r, 0), turn(r, 1), turn(r, 2)};
    pose["scale"] = scale;
    alignment["unit"] = "m";
    alignment["up"] = "+y";
    alignment["forward"] = "+z";
  } catch (const nlohmann::json::exception&) {  // no face was looked for
  }
  return metadata;
}

}  // namespace freetalk::animation
