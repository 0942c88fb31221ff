// Prints what ROS's parser of camera_info files reads, a JSON object for each file.
#include "camera_calibration_parsers/parse_yml.hpp"

#include <iostream>

template<typename Numbers>
static void print(const char * name, const Numbers & numbers)
{
  std::cout << ", \"" << name << "\": [";
  for (size_t i = 0; i < numbers.size(); ++i) {
    std::cout << (i ? ", " : "") << numbers[i];
  }
  std::cout << "]";
}

int main(int argc, char ** argv)
{
  std::cout.precision(17);
  for (int i = 1; i < argc; ++i) {
    std::string name;
    sensor_msgs::msg::CameraInfo info;
    if (!camera_calibration_parsers::readCalibrationYml(std::string(argv[i]), name, info)) {
      return 1;
    }
    std::cout << "{\"name\": \"" << name << "\", \"model\": \"" << info.distortion_model << "\", \"size\": [" <<
      info.width << ", " << info.height << "]";
    print("k", info.k);
    print("d", info.d);
    print("r", info.r);
    print("p", info.p);
    std::cout << "}\n";
  }
}
