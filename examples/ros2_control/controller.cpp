// The controller calls the law once per update and holds its torques in between.
#ifdef STUBS
#include "stubs.hpp"
#else
#include <controller_interface/controller_interface.hpp>
#include <pluginlib/class_list_macros.hpp>
#endif

#include "fuzzy_4_tip.h"

namespace fuzzyarm_controller
{
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

constexpr int LONGEST = 5;  // calls in a row without a measurement that the law acts on

/// Yours: q_d, dq_d, ddq_d of both joints at the time of the measurement. Here the arm holds where it was.
struct Reference
{
  double held[2] = {0.0, 0.0};
  void at(double * wanted) const
  {
    for (int k = 0; k < 6; ++k) {
      wanted[k] = k < 2 ? held[k] : 0.0;
    }
  }
};

class FuzzyArmController : public controller_interface::ControllerInterface
{
public:
  CallbackReturn on_init() override {return CallbackReturn::SUCCESS;}

  InterfaceConfiguration command_interface_configuration() const override
  {
    return {interface_configuration_type::INDIVIDUAL, {"joint1/effort", "joint2/effort"}};
  }

  InterfaceConfiguration state_interface_configuration() const override
  {
    return {
      interface_configuration_type::INDIVIDUAL,
      {"joint1/position", "joint2/position", "joint1/velocity", "joint2/velocity"}};
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    if (get_update_rate() != 1000) {
      return CallbackReturn::ERROR;  // the law is for a period of 1 ms
    }
    for (int k = 0; k < 2; ++k) {
      reference_.held[k] = state_interfaces_[k].get_value();
    }
    fuzzy_4_tip_init(&law_);
    refused_ = 0;
    return CallbackReturn::SUCCESS;
  }

  return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    double observation[10];  // q, dq of the motors [rad, rad/s], then the reference
    for (int k = 0; k < 4; ++k) {
      observation[k] = state_interfaces_[k].get_value();
    }
    reference_.at(observation + 4);
    double torque[2];
    refused_ = fuzzy_4_tip_step(&law_, observation, torque) == 0 ? 0 : refused_ + 1;
    for (int k = 0; k < 2; ++k) {
      command_interfaces_[k].set_value(torque[k]);  // N m, within the limits of the law
    }
    return refused_ > LONGEST ? return_type::ERROR : return_type::OK;
  }

private:
  fuzzy_4_tip_state law_{};
  Reference reference_;
  int refused_ = 0;
};
}  // namespace fuzzyarm_controller

PLUGINLIB_EXPORT_CLASS(fuzzyarm_controller::FuzzyArmController, controller_interface::ControllerInterface)
