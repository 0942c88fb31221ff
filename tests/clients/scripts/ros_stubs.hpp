// The parts of rclcpp, tf2_ros and sensor_msgs that two programs of ROS 2 use, for a machine without ROS.
#pragma once

#include <array>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <sstream>
#include <string>
#include <variant>
#include <vector>

#define RCLCPP_INFO(logger, ...) (void)logger
#define RCLCPP_WARN(logger, ...) ((void)logger, std::fprintf(stderr, __VA_ARGS__))
#define RCLCPP_ERROR(logger, ...) ((void)logger, std::fprintf(stderr, __VA_ARGS__))
#define RCUTILS_LOG_WARN(...) std::fprintf(stderr, __VA_ARGS__)
#define RCUTILS_LOG_ERROR(...) std::fprintf(stderr, __VA_ARGS__)

namespace sensor_msgs {
namespace distortion_models {
const char PLUMB_BOB[] = "plumb_bob";
}
namespace msg {
struct RegionOfInterest
{
  uint32_t x_offset{}, y_offset{}, height{}, width{};
  bool do_rectify{};
};
struct CameraInfo
{
  uint32_t height{}, width{};
  std::string distortion_model;
  std::vector<double> d;
  std::array<double, 9> k{}, r{};
  std::array<double, 12> p{};
  uint32_t binning_x{}, binning_y{};
  RegionOfInterest roi;
};
}
}

namespace rclcpp {
struct Logger {};
inline Logger get_logger(const std::string &) { return {}; }
inline std::vector<std::string> init_and_remove_ros_arguments(int argc, char ** argv) { return {argv, argv + argc}; }
inline void shutdown() {}
template<typename Node> void spin(const Node &) {}
struct Parameter
{
  std::string name;
  std::variant<double, std::string> value;
};
struct NodeOptions
{
  std::vector<Parameter> parameters;
  void parameter_overrides(const std::vector<Parameter> & given) { parameters = given; }
};
}

namespace tf2_ros {
// Prints the parameters of the node that publishes a transform as a JSON object.
struct StaticTransformBroadcasterNode
{
  explicit StaticTransformBroadcasterNode(const rclcpp::NodeOptions & options)
  {
    std::ostringstream text;
    text.precision(17);
    const char * separator = "{";
    for (const auto & one : options.parameters) {
      text << separator << '"' << one.name << "\": ";
      if (const auto * number = std::get_if<double>(&one.value)) {
        text << *number;
      } else {
        text << '"' << std::get<std::string>(one.value) << '"';
      }
      separator = ", ";
    }
    text << "}\n";
    std::fputs(text.str().c_str(), stdout);
  }
  rclcpp::Logger get_logger() const { return {}; }
};
}
