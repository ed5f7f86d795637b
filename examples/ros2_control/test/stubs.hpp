// The declarations of ros2_control that controller.cpp needs, so that it compiles and runs without ROS 2.
#pragma once
#include <string>
#include <vector>

namespace rclcpp
{
struct Time {};
struct Duration {};
}  // namespace rclcpp

namespace rclcpp_lifecycle
{
struct State {};
}  // namespace rclcpp_lifecycle

namespace controller_interface
{
enum class CallbackReturn {SUCCESS, ERROR};
enum class return_type {OK, ERROR};
enum class interface_configuration_type {INDIVIDUAL};
struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names;
};
struct Interface
{
  double value = 0.0;
  double get_value() const {return value;}
  void set_value(double to) {value = to;}
};
struct ControllerInterface
{
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual return_type update(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  unsigned get_update_rate() const {return rate;}
  unsigned rate = 1000;
  std::vector<Interface> command_interfaces_{2};
  std::vector<Interface> state_interfaces_{4};
};
}  // namespace controller_interface

#define PLUGINLIB_EXPORT_CLASS(kind, base) extern "C" base * made() {return new kind();}
